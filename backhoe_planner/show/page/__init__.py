"""One page that plays a plan offline."""
