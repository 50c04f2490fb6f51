"""Scan matchers behind one narrow interface."""
