"""What finished stages made, kept between runs under a key of everything that it depends on."""
