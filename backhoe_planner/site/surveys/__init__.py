"""Files of surveys: heights on grids, GeoTIFFs, lists of points."""
