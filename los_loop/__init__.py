"""The loop of telescope, observer and controller: sampled matrices, responses, tones, margins."""
