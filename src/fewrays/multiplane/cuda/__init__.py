"""The multiplane method on a GPU.

`planes` is what `fewrays.multiplane.maps` is on the host, with blocks on the card. `assign` sorts samples
into planes, `build` fills these, `smoothing` makes the copies that views look at, and `render` images.
"""
