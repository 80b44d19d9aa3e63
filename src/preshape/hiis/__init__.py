"""The paper: Hybrid Intelligent Inference System (HIIS), each part under the paper's name."""
