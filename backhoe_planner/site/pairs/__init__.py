"""Bounds on the distances of many pairs, which show which of the pairs have to be measured."""
