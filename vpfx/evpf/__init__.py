"""Hierarchical TINs as directories of VPF, and back (specs/evpf.md)."""
