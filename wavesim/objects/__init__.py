"""What stands in front of the lens: charts, phantoms, pictures, and the light on them."""
