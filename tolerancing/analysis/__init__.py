"""What a store says: yields, sensitivities, inverse limits, budgets."""
