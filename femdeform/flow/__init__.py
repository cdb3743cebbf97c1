"""Incompressible flow on a staggered (MAC) grid."""
