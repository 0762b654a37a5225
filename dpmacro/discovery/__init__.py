"""DPBoost: boosting and segmentation in turn, and which segmentation to keep."""
