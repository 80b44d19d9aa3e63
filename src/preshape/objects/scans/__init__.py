"""Point clouds: from what a depth camera saw of an object to a closed surface, arrays in and arrays out."""
