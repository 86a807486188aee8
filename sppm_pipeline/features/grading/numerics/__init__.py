"""Parameters that vary through a part: formulas and data as functions of place, and levels that follow them."""
