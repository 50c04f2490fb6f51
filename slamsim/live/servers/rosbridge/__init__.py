"""A rosbridge v2 server: ``server.start_rosbridge``."""
