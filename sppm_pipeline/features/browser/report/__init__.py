"""Reports of finished runs: one HTML file that holds everything and fetches nothing."""
