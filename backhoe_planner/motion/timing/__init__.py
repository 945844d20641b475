"""When a motion is where, as fast as the limits allow."""
