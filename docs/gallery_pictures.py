"""What the gallery's scripts draw: sphinx-gallery asks for it after each of them."""

import shutil
from pathlib import Path

from sphinx_gallery.scrapers import figure_rst


def collect(block, block_vars, gallery_conf):
    """Move the picture or film with the script's name to where the site has its own."""
    script, figures = Path(block_vars["src_file"]), []
    for drawn in (script.with_suffix(".png"), script.with_suffix(".gif")):
        if drawn.exists():
            place = Path(next(block_vars["image_path_iterator"]))
            place = place.with_suffix(drawn.suffix)
            shutil.move(drawn, place)
            figures.append(place)
    return figure_rst(figures, gallery_conf["src_dir"])
