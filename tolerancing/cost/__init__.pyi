from .pricing import Cost, CostLine, cost_of
from .table import CostTable, load_costs

__all__ = ["Cost", "CostLine", "CostTable", "cost_of", "load_costs"]
