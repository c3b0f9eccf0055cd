"""What commands say: notes, results, the words they are told in, their JSON, and limits on them."""
