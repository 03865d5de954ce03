"""The multiplane method on a GPU.

`planes` is what `fewrays.multiplane.maps` is on the host, with blocks on the card; `render` makes images of
them.
"""
