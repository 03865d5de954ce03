"""What the papers compare with, as methods of the same shape.

Each module holds one method as ``METHOD``.
"""
