"""Connecting pores by tunnels: candidate graphs, spanning trees, spanning subgraphs with bounded degrees, connectors.

A tunnel graph is two arrays: ``edges`` (m, 2) int64, pairs of pore indices i < j, and ``shifts`` (m, 3) int64; the
tunnel runs from ``points[i]`` to ``points[j] + shift``. In a periodic cell (the unit cube) two pores may be joined by
several tunnels, to different images; without periodicity every shift is zero.
"""
