"""tomthumb: landmark SLAM with data association."""

__version__ = "0.1.0.dev0"
