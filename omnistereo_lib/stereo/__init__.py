"""The method, fast: sweep, matching costs, cost volume, SGM, depth, metrics; `reference` defines
what they give.
"""
