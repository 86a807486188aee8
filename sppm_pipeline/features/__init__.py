"""Capabilities beyond the method, a folder each: none imports another, and nothing else imports them."""
