"""Motion along the road: reference paths, routes, curves, car following and lane changes."""
