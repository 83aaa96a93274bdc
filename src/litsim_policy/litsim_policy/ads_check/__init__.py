"""What `check_ads` finds out about a driving system at the ego port, and how it judges that."""
