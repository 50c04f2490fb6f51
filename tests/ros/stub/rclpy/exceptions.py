from __future__ import annotations


class ParameterException(Exception):
    pass


class InvalidParameterTypeException(ParameterException):
    pass


class InvalidHandle(RuntimeError):
    pass


class InvalidTopicNameException(Exception):
    pass
