"""Rules V7xx: VPF directories, and our own extension of VPF."""
