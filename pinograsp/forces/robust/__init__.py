"""Forces and grasps that withstand more than the load: reserves, sets of loads, margins, sensitivity."""
