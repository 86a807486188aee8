"""Two colors of pores, and the waves of a field that is relaxed between them."""
