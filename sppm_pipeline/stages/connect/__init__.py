"""Stages that join pores by tunnels."""
