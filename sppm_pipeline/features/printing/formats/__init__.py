"""Files of resin printers."""
