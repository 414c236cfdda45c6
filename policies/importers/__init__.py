"""Importers: public policy formats become skills of ours, without editing a file of theirs."""
