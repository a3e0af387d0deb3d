"""Problems in files: .npz, Matrix Market, .mat, QPS and MPS."""
