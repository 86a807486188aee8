"""What the method and the features share: arrays in, arrays out, and pictures; nothing here knows a stage."""
