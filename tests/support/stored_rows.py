"""What runs left in stores, to compare them."""

import sqlite3

TABLES = {
    "trial": "trial",
    "high_fidelity": "trial",
    "step": "series, step, merit",
    "picture": "series, step, refocused",
    "merit": "label",
    "file": "name",
}

WHEN = ("seconds", "finished")


def rows(path):
    """All results of a store, bit by bit, but for the times that they took."""
    found = {}
    with sqlite3.connect(path) as connection:
        for table, order in TABLES.items():
            names = [
                row[1] for row in connection.execute(f"PRAGMA table_info({table})") if row[1] not in WHEN
            ]
            columns = ", ".join(f'"{name}"' for name in names)
            found[table] = connection.execute(f"SELECT {columns} FROM {table} ORDER BY {order}").fetchall()
    connection.close()
    return found
