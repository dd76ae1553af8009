"""The commands of `omnistereo`, one module each; what is slow is imported when one runs."""
