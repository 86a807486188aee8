"""Straightforward scripts for the same work with well-known libraries, which this program is compared with."""
