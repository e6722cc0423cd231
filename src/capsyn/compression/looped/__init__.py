"""Small trees that are fitted to where closed loops go, and judged by what these do."""
