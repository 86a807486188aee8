"""The live view: what a browser needs to show a structure, as one file, and the scripts that show it."""
