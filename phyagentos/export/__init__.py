"""Evidence of verified sessions as data sets of others; reads bundles and the journal, touches neither plane."""
