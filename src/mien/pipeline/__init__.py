"""The whole way from a video to the files of a track: the first frame, the passes of a tracker over all frames, what is
drawn meanwhile, and what is written in the end."""
