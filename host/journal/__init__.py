"""Records jobs so that they survive a crash: the journal, its repair, and what it says of an array that is down."""
