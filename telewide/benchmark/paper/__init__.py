"""The published comparison, table by table, for the systems and the data sets that are there."""
