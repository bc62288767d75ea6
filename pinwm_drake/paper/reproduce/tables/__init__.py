"""The paper's tables, one module each: the cells that it needs, and its rows."""
