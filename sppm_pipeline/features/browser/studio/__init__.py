"""The studio: a page on this machine on which a cell is designed; what it makes is a configuration file."""
