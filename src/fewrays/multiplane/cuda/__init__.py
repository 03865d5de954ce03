"""The multiplane method on a GPU.

`planes` is what `fewrays.multiplane.maps` is on the host, with blocks on the card; `build` makes them of
samples, and `render` images of them.
"""
