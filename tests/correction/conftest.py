"""The small scene that these tests share."""

from small_scene import wide_src, world

__all__ = ["wide_src", "world"]
