"""A rosbridge v2 server: ``server.RosbridgeServer``."""
