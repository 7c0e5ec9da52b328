"""Targets that an operator chose: kept while the arm drives, looked at in place of the object's markers."""
