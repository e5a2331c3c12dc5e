from .registry import OracleCase, oracle_case

__all__ = [
    "OracleCase",
    "oracle_case",
]
