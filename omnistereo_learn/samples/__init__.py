"""Training samples: what each network is shown, and what its loss compares."""
