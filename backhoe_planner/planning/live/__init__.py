"""Plans that are followed while things turn up, and motions that were driven."""
