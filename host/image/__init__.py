"""Makes files of pictures: exact sums, transfer to bytes, moving pictures, numbered frames, whole or not at all."""
