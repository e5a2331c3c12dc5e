"""What rays say of a lens: matching (Eq. 1), spread (Eq. 2), arrival, first order, form errors, the check."""
