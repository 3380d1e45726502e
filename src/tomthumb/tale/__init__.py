"""What the forest and the associator share: Lévy lengths, the trail, the STDP memories and the 3 x 3 window."""
