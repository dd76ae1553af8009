"""The machinery of the course: exercises, figures, the classroom, tools for notebooks."""
