"""The paper's Hybrid Intelligent Inference System (HIIS); each part has the paper's name."""
