"""The arm of CALVIN, served to phyagentos."""
