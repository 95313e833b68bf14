"""A benchmark of novel-view synthesis for reflective scenes, on one shared Gaussian rasterizer and ray tracer."""
