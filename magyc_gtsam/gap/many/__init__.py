"""One comparison over many logs of one instrument: which effect has one value in all, and which one in each."""
