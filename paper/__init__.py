"""The paper beside this toolkit: equations, tables, figures and numbers, by one command, on one page.

python -m paper --quick
"""
