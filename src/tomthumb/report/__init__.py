"""Figures, tables and the self-contained HTML page of finished runs. Reads rows and saved runs only."""
