"""Pictures of recordings and maps, and the frame of HTML pages."""
