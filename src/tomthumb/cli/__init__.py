"""The command line. Modules here import nothing heavy at their top: the help of all of them must open at once."""
