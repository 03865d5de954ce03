"""Where samples come from: renderers, and scenes whose exact image is known.

Import the source that you need, such as ``fewrays.sources.analytic``; the ones that drive a renderer need
its extra to be installed.
"""
