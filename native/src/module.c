/* Functions on arrays that backhoe_planner has in plain Python too, where each is explained. */
#define BACKHOE_MODULE
#include "arrays.h"

typedef PyObject *Function(PyObject *, PyObject *const *, Py_ssize_t);

PyObject *joints_beyond;
static PyObject *plain; /* the plain versions by name: backhoe_planner puts them in */

/* What the function answers, or its plain version where there are more joints than the function has room for. */
static PyObject *answer_of(Function *function, const char *name, PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    PyObject *found = function(self, args, count);
    if (found || !PyErr_ExceptionMatches(joints_beyond))
        return found;
    PyObject *other = PyDict_GetItemString(plain, name);
    if (!other)
        return NULL;
    PyErr_Clear();
    return PyObject_Vectorcall(other, args, count, NULL);
}

#define ANSWERED(name)                                                                           \
    static PyObject *name##_or_plain(PyObject *self, PyObject *const *args, Py_ssize_t count) \
    {                                                                                            \
        return answer_of(name, #name, self, args, count);                                        \
    }
FUNCTIONS(ANSWERED)

#define ENTRY(name) {#name, (PyCFunction)(void (*)(void))name##_or_plain, METH_FASTCALL, NULL},

static PyMethodDef functions[] = {FUNCTIONS(ENTRY){NULL, NULL, 0, NULL}};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, "backhoe_planner_native", "Compiled functions of backhoe_planner.", -1, functions,
    NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit_backhoe_planner_native(void)
{
    import_array();
    PyObject *made = PyModule_Create(&module);
    joints_beyond = PyErr_NewException("backhoe_planner_native.JointsBeyond", PyExc_ValueError, NULL);
    plain = PyDict_New();
    if (!made || !joints_beyond || !plain || PyModule_AddObjectRef(made, "plain", plain) < 0 ||
        PyModule_AddIntConstant(made, "INTERFACE", 20) < 0) {
        Py_XDECREF(made);
        return NULL;
    }
    return made;
}
