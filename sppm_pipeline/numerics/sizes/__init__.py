"""How large pores and struts are: exact distances on voxels and the local thickness."""
