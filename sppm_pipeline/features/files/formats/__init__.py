"""File formats: bytes in, arrays out and back. Nothing here opens a file or knows of stages."""
