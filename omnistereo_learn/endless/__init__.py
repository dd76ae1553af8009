"""Training frames without a data set: a ray caster, its scenes, and the worlds drawn from them."""
