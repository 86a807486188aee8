"""The obvious ways to do the same work, with well-known libraries and no tricks; what ours is measured against."""
