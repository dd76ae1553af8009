"""The method, fast: sweep, costs, volume, SGM, depth, metrics; `reference` defines them."""
