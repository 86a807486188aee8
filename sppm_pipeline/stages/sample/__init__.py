"""Pores are thrown."""
