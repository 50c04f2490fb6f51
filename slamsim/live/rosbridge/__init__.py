"""The rosbridge v2 protocol, as its server and its client share it."""
