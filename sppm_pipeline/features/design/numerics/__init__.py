"""The search of a porosity by the ratio of sizes."""
