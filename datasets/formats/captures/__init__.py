"""Exports of other capture programs, read only."""
