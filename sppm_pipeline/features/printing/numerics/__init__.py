"""Effects of a printer on layers: trapped resin, islands, overhang, throats, thin features, cure-through and peel.

Layers come one by one from the build plate upwards and are never all in memory. Half-stack k is layers 0 to k: what has
been printed when layer k is, with the film of the vat below it. Solid and void are joined across faces (6 neighbors).
"""
