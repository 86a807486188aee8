"""Bytes of files that several features read or write."""
