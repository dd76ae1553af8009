"""Where do the cameras stand? Lenses and poses: from boards, from images, from other programs'
files.
"""
