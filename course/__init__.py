"""What only the course needs: exercises, notebook plots, the reproduction report, notebook and book tools."""
