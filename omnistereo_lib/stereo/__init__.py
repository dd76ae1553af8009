"""The method: sweep, matching costs, cost volume, SGM, depth, metrics (paper, Section III and IV)."""
