"""Routes in joint space, checked or proven clear."""
