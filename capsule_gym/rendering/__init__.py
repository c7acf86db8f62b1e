"""Pictures of the robot: windows, RGB frames and GIFs."""

from capsule_gym.rendering.gif import write_gif
from capsule_gym.rendering.renderer import FRAME_SECONDS, Renderer

__all__ = ["FRAME_SECONDS", "Renderer", "write_gif"]
