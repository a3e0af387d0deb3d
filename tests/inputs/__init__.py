"""Problems and strategies that several folders of tests use."""
