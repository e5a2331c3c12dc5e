from .arrangement import Arrangement, OrientedLens, StockLens
from .index import IndexedFile, StockIndex, index_stock
from .search import StockMatch, StockResult, StockSettings, find_stock_lenses

__all__ = [
    "Arrangement",
    "IndexedFile",
    "OrientedLens",
    "StockIndex",
    "StockLens",
    "StockMatch",
    "StockResult",
    "StockSettings",
    "find_stock_lenses",
    "index_stock",
]
