"""Files, pictures and what one sees while a run goes."""
