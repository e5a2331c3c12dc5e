"""The sensor behind the lens: its pixels, exposures, frames and their files."""
