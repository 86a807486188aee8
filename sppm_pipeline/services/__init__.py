"""Services of the method and the features: arrays in, arrays out, and pictures; nothing here knows a stage."""
