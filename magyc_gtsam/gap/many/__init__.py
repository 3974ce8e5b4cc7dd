"""One comparison over many logs of one instrument: effects with one value in all logs, and with a value in each."""
