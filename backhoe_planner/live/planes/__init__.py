"""Planes between the machine and what it must not touch, and the distances along a path that they prove.

`Separation` holds what is known of all pairs of bodies, a plane of each among it. The other modules are functions on
it: `narrow_phase` measures a pair and with it a plane, `plane_gaps` has the bounds that follow from one plane of each
pair, `close_look` those from several planes of one pair, `path_rows` the rows that a velocity must keep for them, and
`cluster_boxes` finds the bodies of clusters. `pair_choice` says which pairs a step looks at.
"""
