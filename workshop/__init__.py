"""How the data, the book and the tables were made: nobody needs this to use or study the course."""
