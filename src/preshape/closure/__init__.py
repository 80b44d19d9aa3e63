"""The closure analyser: preshapes that a real hand can execute, ranked by how well they resist."""
