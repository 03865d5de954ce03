"""The multiplane method on a GPU.

`planes` is what `fewrays.multiplane.maps` is on the host, with blocks on the card. `assign` sorts samples
into planes, `build` fills these, and `render` makes images of them.
"""
