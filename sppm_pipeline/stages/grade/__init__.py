"""Stages that say how a parameter varies through a part."""
