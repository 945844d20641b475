"""As fast as the limits of joints, drive and tip allow."""
