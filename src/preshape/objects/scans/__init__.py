"""Point clouds: from the points of a depth camera to a closed surface, arrays in and arrays out."""
