"""The paper's reference profiles and control laws."""
