"""Arrays in, arrays out: the mathematics of the method, one topic a file, free of files, logging and configuration."""
