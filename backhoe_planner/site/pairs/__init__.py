"""Bounds on the distances of many pairs, from which it is known which of them have to be measured."""
