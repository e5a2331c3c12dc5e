"""Exact solutions that engines are held against."""
